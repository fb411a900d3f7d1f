from .not_everywhere import anything
