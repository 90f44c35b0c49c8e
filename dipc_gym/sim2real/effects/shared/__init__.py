"""What effects are made of: what one is, and what several of them share."""
