"""Dataset formats, one module or package each: how a dataset is recognised, read and written.

A format's module has `recognises(path)` and `opened(path)` (`xpl_cli.basics.formats`); `xpl_cli.data.reading` opens
datasets.
"""
