"""The wire: messages and bytes. Sans-IO; imports nothing else of the project."""
