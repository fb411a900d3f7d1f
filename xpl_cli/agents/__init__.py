"""For agents and bots: skills, reviews, and where a package stands."""
