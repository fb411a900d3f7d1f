"""YAML as people write it: read with the place of every value, and edited without touching the rest."""
