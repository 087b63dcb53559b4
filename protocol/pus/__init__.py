"""The language of ECSS-E-ST-70-41C (PUS-C) in CCSDS space packets: messages, tables and codec."""
