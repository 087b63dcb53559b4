"""Units: their files, what these hold and how they are validated."""
