"""A double inverted pendulum on a cart with stick-slip friction."""
