"""What the cameras' pictures are worth: corrections applied on reading, noise, preheating.

Raw counts are never altered.
"""
