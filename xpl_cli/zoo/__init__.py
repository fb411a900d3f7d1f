"""The zoo at work: it lists the field's policies, and proves how far each of them runs here."""
