"""What a search comes to: what is named, how sure it is, and what is written back."""
