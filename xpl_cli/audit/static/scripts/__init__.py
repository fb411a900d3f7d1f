"""Shell scripts of a package: their commands, and whether they run anything; none is executed."""
