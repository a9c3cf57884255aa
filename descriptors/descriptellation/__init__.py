"""The paper's descriptor: network, training on simulated maps, weights that ship."""
