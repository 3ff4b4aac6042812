"""Processing blocks of ISO 13374, one file a stage; they meet in values (`agent.types`) and in the pipeline only.

Beside the stages: `rig_model` (a configuration as mathematics), and what one stage alone uses. May import
`agent.numerics` and `agent.config`; imported by `agent.runtime` and what is above it.
"""
