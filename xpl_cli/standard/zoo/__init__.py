"""The zoo: which policies the field has, what is known of each, and how far each was proven to run here."""
