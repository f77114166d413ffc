"""The tables and figures of Sayers et al. (2010), made again from simulated observations."""
