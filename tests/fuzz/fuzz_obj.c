/* SPDX-License-Identifier: MIT */
/* Meshes: any bytes are read as Wavefront OBJ or refused; what was read can be rendered. */
#include "fuzz_file.h"

#include <math.h>

#include "cli.h"
#include "render/mesh.h"

static int finite3(vec3 v) {
  return isfinite(v.x) && isfinite(v.y) && isfinite(v.z);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  fuzz_file file = fuzz_file_make(data, size);
  mesh m;
  const int failed = mesh_obj(file.path, 1.0f, &m);
  fuzz_file_drop(&file);
  if (failed == EXIT_DONE) {
    fuzz_expect(m.triangle_count >= 1 && m.vertex_count >= 1);
    for (size_t i = 0; i < 3 * (size_t)m.triangle_count; i++) fuzz_expect(m.triangles[i] < m.vertex_count);
    for (uint32_t i = 0; i < m.vertex_count; i++) {
      const mesh_vertex *v = &m.vertices[i];
      fuzz_expect(finite3(v->position) && finite3(v->normal) && isfinite(v->u) && isfinite(v->v));
      fuzz_expect(vec3_length(v->position) <= 1.001f);
    }
  }
  mesh_free(&m);
  return 0;
}
