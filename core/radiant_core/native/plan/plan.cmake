# The planner's kernels: loops over all cameras, compared to the last digits.
set(PLAN_SOURCES ${NATIVE}/plan/bind.cpp ${NATIVE}/plan/camera_tree.cpp ${NATIVE}/plan/soft_counts.cpp ${NATIVE}/plan/augment.cpp
    ${NATIVE}/plan/deal.cpp ${NATIVE}/plan/cell_polygons.cpp)
target_sources(_native PRIVATE ${PLAN_SOURCES})
set_source_files_properties(${PLAN_SOURCES} PROPERTIES COMPILE_OPTIONS "-O3;-fno-fast-math;-ffp-contract=off")
