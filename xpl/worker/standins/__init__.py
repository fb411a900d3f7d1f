"""Stand-ins for the libraries and models that an unmodified adapter imports: shadow mode for a bare class `Model`.

What is not installed here is stood in for: `torch` by a small one on numpy, checkpoints by files that are made when
they are looked for, all else by things (`xpl.worker.standins.things`) that remember what they were given. When actions
are asked of a thing, the answer is a fixed function of everything that went into it.
"""
