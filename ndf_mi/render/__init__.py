"""How samples of a field become pixels: emission and absorption by quadrature, sampling, the shell."""
