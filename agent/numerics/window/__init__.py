"""Sliding windows summarised from shared blocks of samples, and what each window estimates by itself."""
