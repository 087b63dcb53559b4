"""The device in PUS: reception, verification, transmission, and one module a service."""
