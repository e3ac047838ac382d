# The planner's kernels: loops over all cameras, compared to the last digits.
set(PLAN_SOURCES ${NATIVE}/bind_plan.cpp ${NATIVE}/camera_tree.cpp ${NATIVE}/soft_counts.cpp ${NATIVE}/augment.cpp
    ${NATIVE}/deal.cpp ${NATIVE}/cell_polygons.cpp)
target_sources(_native PRIVATE ${PLAN_SOURCES})
set_source_files_properties(${PLAN_SOURCES} PROPERTIES COMPILE_OPTIONS "-O3;-fno-fast-math;-ffp-contract=off")
