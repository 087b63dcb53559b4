"""A dialect of my own: the language of my unit on its wire."""
