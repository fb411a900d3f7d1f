"""Views of an episode: frames and curves as an HTML page, a picture, or a Rerun recording."""
