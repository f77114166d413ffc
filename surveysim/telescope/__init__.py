"""The camera and its scans: focal plane, optics, photon noise, scan patterns and pointing."""
