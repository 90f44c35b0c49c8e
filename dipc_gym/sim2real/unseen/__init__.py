"""Parts that no sensor shows: which of them a model has, and what they have come to from how its joints moved."""
