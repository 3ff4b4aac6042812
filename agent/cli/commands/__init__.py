"""The command line's signatures, a module a section of the help; bodies are in the rooms beside this one.

A command imports its body when it runs, so that `deltak --help` answers at once. Bodies return the documents
of the JSON interface as plain dicts; the commands print them. Only `agent.cli.app` imports from here.
"""
