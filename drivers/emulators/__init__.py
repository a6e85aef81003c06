"""The same chips and devices from the other side of the wire."""
