"""Does a unit fit its frame period: cycles, margins, worst frames and memory, worked out before flight."""
