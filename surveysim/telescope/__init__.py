"""The camera and its scans: focal plane, optics, photon noise, raster and pointing."""
