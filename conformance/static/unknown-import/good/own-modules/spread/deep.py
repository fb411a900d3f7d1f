value, other = 1, 2
