"""What runs: the deterministic pipeline, the service with its threads, sources, replay, containment of failures.

May import `agent.recording`, `agent.storage` and `agent.blocks`; imported by commissioning, evaluation, command line.
"""
