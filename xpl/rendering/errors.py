"""Error of a machine that cannot render."""

from __future__ import annotations


class RendererMissingError(RuntimeError):
    """This machine lacks the environment's renderer; audits then report `not run`, and videos are left out."""

    @classmethod
    def of(cls, renderer: str, error: Exception) -> RendererMissingError:
        """Return the error of a failed renderer that only cameras need."""
        return cls(f"{renderer} cannot render ({type(error).__name__}: {error}); policies without cameras still run")
