"""The language of NASA's generic star tracker (NOS3): nine-octet commands, echo, two replies. Sans-IO."""
