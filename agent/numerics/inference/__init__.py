"""What one window says, by one linear-Gaussian model whitened exactly in the frequency domain.

    y = Γ e0 + Ψ δ + Ξ η + n,    n ~ N(0, S)

e0 is the window's own initial state (flat), δ the deviation of the parameters of interest (flat, fresh in
each window), η the constants of the rig (prior from the data sheet, carried from window to window), S sensor
noise and unknown forces, whose sizes are carried too. `model.uncertain` says what is modelled, `spectral`
puts a window into this form, `noise` learns S, `constants` learns η, `learner` is the way through all of them
for one window.
"""
