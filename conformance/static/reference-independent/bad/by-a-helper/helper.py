"""Help."""

import xpl.convert  # noqa: F401
