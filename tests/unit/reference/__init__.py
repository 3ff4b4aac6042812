"""Tests of references of healthy machines."""
