"""CAN: bits and frames, packets by ISO-TP (ISO 15765-2), cyclic frames."""
