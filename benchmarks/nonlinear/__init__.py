"""A whole sequence as one nonlinear program in CasADi, solved by IPOPT: the peer of the package's own search."""
