"""Tables and figures of Sayers et al. (2010), reproduced from simulated observations."""
