"""What consumers are to the forwarder: peers, and what all kinds of them share."""
