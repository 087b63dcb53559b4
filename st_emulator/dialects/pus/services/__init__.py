"""The services: what each telecommand checks and does, one module each, the twin of its messages' module in
``protocol.pus.services``.
"""
