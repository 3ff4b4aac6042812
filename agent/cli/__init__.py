"""The command line: `commands` holds signatures, the other rooms what commands print or serve."""
