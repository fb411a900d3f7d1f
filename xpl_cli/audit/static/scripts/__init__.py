"""Shell scripts of a package: their words, what they run, and whether anything is behind them; none is executed."""
