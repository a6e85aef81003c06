"""What a diagnosis says: findings, proof on held-out data, evidence, what cannot be known."""
