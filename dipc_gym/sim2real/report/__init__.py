"""The report: what it says, its plots and its page."""
