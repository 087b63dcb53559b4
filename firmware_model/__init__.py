"""What runs on the processing unit. It gets pixels, times and commands, never the truth."""
