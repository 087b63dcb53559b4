"""The dialect ``nos3``: NASA's generic star tracker on a serial line."""
