"""Recordings on disk: one file per format."""
