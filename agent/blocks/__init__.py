"""The stages of the pipeline (ISO 13374), one file a stage: a step takes what the stage before returned.

They meet in values only. Imported by recording, runtime, commissioning and evaluation.
"""
