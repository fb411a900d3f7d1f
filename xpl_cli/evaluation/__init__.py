"""Episodes played, recorded, summed up, compared and reported."""
