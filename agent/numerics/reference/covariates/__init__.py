"""What a healthy parameter depends on (temperature, load, speed): lags, the regression, the compensated reference."""
