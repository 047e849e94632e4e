"""The geometry of a pair from its views: solving, distortion, uncertainty, acceptance, the record, rectification."""
