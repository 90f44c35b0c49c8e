"""The paper's identification run: what it excites, what it records, and what that says about friction."""

from dipc_gym.identification.run import Cart, Sweep

__all__ = ["Cart", "Sweep"]
