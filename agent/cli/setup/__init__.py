"""What examples, init and listen ask and print."""
