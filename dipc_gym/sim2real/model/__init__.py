"""The model under diagnosis: its structure, and the parameters of its own that may be wrong."""
