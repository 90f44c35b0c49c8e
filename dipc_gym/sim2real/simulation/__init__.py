"""Simulate windows of recordings with many variants of a model at once."""
