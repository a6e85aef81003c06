"""What the simulator is made of: true motions and noise. `calib.simulate` puts them together."""
