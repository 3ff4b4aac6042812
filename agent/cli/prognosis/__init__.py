"""What `trend` and `fleet` print of histories: documents, words and a picture; imported by the commands."""
