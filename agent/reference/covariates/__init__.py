"""What a healthy parameter depends on (temperature, load, speed): lags, regression, compensated reference."""
