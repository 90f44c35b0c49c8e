"""From recordings to states, residuals and fits."""
