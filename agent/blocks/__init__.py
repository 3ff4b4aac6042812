"""The spine: one file a processing block (ISO 13374), each with step / reset / snapshot / restore."""
