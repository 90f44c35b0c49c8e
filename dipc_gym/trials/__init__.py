"""Blind trials: rigs with concealed physics, simulated without MuJoCo, and their scorer."""
