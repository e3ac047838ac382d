"""The steps that pycolmap computes: features, matches, mapping, bundle adjustment, undistortion."""
