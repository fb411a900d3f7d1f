"""For agents and bots: skills, tools of the Model Context Protocol, reviews, and where a package stands."""
