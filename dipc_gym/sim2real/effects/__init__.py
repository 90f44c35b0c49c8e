"""The catalogue of physical effects, one file an effect."""
