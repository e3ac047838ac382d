"""Alignments of other programs, and which test shows what of each.

| file | written by | truth | wrong conventions | 10⁵ mutations | held-out PSNR |
|---|---|---|---|---|---|
| transforms.json | `writers`; nerfstudio 1.1.5's colmap_to_json | A | B | F transforms | P |
| reconstruction.json, tracks.csv | `writers` | A | B, half a pixel | F opensfm | P |
| cameras.xml, three forms | `writers` | A | B | F metashape | P |
| RealityScan's table | `writers` | A | B | F realityscan | P |
| Pix4D, two forms | `writers` | A | B | F pix4d | P |
| project.opf | `writers`; pyopf 1.4.1 | A | B | F opf | P |
| sfm_data.json, two forms | `writers` | A | B, half a pixel | F openmvg | P |
| bundle.out | `writers`; colmap 3.8's model_converter | A | B | F bundler | P |
| keyframes/ | `writers` | A | B | F polycam | P |
| sparse/, text and binary | pycolmap 4.2, test_colmap.py | A of its faces | check of poses | F colmap | is the true one |

A   `test_readers.py`: centres 1 mm, rotations 0.001°, reprojection 0.01 px, lenses with k1, k2, k3, p1, p2, k4, skew
B   `test_readers.py` (one each), `tests/stress/test_pose_conventions.py` (all): sign of k1, c2w for w2c, y up, p1 for p2, centre
    for t; half a pixel where the file says what its photographs see
F   `python -m tests.stress.reader_fuzz NAME 100000`, `make stress`; a thousand of each in every suite
P   `python -m tests.stress.pose_formats`, docs/begun_elsewhere.md
All of them: found by `radiant run FOLDER` in one line (`tests/stress/test_dropped_folders.py`), known points within 1 mm in every
export, in local metres, ENU, EPSG:25832 and ECEF (`tests/app/test_alignments.py`). `writers` shares no code with the readers, and
`bent_hamlet` takes its truth from OpenCV.
"""
