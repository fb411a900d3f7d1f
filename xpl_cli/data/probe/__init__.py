"""Measurement of the conventions of demonstrations: action reference, rotation form, units, orders, rate, cameras."""
