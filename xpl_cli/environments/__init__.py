"""What environments offer: listed, played, checked, drawn."""
