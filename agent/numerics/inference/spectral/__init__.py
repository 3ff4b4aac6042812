"""One window as a complex regression over frequency bins: responses, columns, covariance, sources of noise.

Imported by the rest of `inference` and by what places the operating point; it imports the model alone.
"""
