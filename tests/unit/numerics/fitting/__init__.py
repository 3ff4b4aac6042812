"""Tests of one window fitted alone."""
