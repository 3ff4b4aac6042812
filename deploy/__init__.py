"""What belongs to a gateway beside the program itself; package/ makes what is handed out."""
