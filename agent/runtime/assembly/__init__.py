"""From a configuration to the stages that it needs, and what its model cannot do; nothing here runs.

Imported by the pipeline and by commissioning.
"""
