"""Figures that come out the same everywhere, and pictures of the rig without a display."""
