"""What keeps an adapter's processes from the rest of the machine, and finds all of them again."""
