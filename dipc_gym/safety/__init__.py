"""What comes from outside and what stays behind: hostile input refused in plain words, files whole or not at all."""
