"""Training of policies: one, or a sweep of them."""
