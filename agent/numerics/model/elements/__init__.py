"""Models put together of elements of any domain: E(θ) x' = F(θ) x + G(θ) u, y = H(θ) x + J(θ) u."""
