"""The rig in equations: linear about an equilibrium (`rigid`), and the whole motion (`motion`)."""
