"""What a gateway's administrator asks a running agent: status, reload, diag."""
