"""`python -m xpl_cli` is `xpl`."""

from xpl_cli.main import run

run()
