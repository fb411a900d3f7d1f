"""What lacks where nothing can be drawn."""

from __future__ import annotations


class RendererMissingError(RuntimeError):
    """This machine lacks what the environment draws with; audits then say `not run`, and films are left out."""

    @classmethod
    def of(cls, renderer: str, error: Exception) -> RendererMissingError:
        """Return what to say where a renderer failed and only cameras need it."""
        return cls(f"{renderer} cannot draw here ({type(error).__name__}: {error}); policies without cameras still run")
