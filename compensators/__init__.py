"""Inverse models of motor and friction."""
