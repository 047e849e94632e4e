"""What a camera does to the picture: reference views, non-uniformity, bad pixels, shading, scale, noise, warming up."""
