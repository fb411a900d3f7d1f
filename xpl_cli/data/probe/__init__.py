"""Conventions of demonstrations, measured: what commands are counted from, forms, units, orders, rates, cameras."""
