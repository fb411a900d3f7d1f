"""The policy zoo: listing of published policies, and proofs of how far each runs here."""
