"""The world outside the unit: sky, camera, trajectory. The truth lives here and only here."""
