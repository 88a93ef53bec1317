"""What a stage has to tell: codes with values, and the one place where they become sentences."""
