# -*- coding: latin-1 -*-
"""Not UTF-8, and says so: grün."""
