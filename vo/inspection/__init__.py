"""What a recording holds, how sound it is, and what is wrong with it."""
