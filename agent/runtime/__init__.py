"""What runs: the pipeline and its ledger, one rig, the service with its readers, replay, failure containment.

Imported by commissioning, evaluation and the command line.
"""
