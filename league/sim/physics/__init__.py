"""Motion and contacts: tyres, bodies, and the two solvers."""
