/* SPDX-License-Identifier: MIT */
#include "dataset/pieces.h"

void btfi_pieces_cut(btfi_pieces *p, const btf_block *b, uint32_t order, uint64_t room, bool one_view) {
  static const int image_major[4] = {3, 2, 1, 0}, texel_major[4] = {1, 0, 3, 2};
  const int *innermost_first = order == BTF_ORDER_YXVLC ? texel_major : image_major;
  const uint32_t size[4] = {b->views, b->lights, b->height, b->width};
  p->whole = *b;
  p->cells = 1;
  p->total = 1;
  for (int i = 0; i < 4; ++i) {
    const int k = innermost_first[i];
    uint64_t extent = BTFI_MAX(room / p->cells, 1u);
    if (k == 0 && one_view) extent = 1;
    p->extent[k] = (uint32_t)BTFI_MIN(extent, size[k]);
    p->count[k] = (size[k] - 1) / p->extent[k] + 1;
    p->cells *= p->extent[k];
    if (!btfi_mul(p->total, p->count[k], &p->total)) p->total = UINT64_MAX;
  }
}

btf_block btfi_pieces_at(const btfi_pieces *p, uint64_t index) {
  const btf_block *b = &p->whole;
  const uint32_t size[4] = {b->views, b->lights, b->height, b->width};
  uint32_t first[4], n[4];
  for (int k = 3; k >= 0; --k) {
    first[k] = (uint32_t)(index % p->count[k]) * p->extent[k];
    n[k] = BTFI_MIN(p->extent[k], size[k] - first[k]);
    index /= p->count[k];
  }
  const btf_block part = {
      b->view0 + first[0], n[0], b->light0 + first[1], n[1], b->x0 + first[3], b->y0 + first[2], n[3], n[2]};
  return part;
}

ptrdiff_t btfi_block_offset(const btf_block *whole, const btf_block *part, const btf_strides *s) {
  return (ptrdiff_t)(part->view0 - whole->view0) * s->view +
         (ptrdiff_t)(part->light0 - whole->light0) * s->light + (ptrdiff_t)(part->y0 - whole->y0) * s->y +
         (ptrdiff_t)(part->x0 - whole->x0) * s->x;
}

btf_strides btfi_block_strides(const btf_block *b, uint32_t channels, uint32_t order, uint32_t size) {
  btf_strides s;
  s.channel = (ptrdiff_t)size;
  if (order == BTF_ORDER_YXVLC) {
    s.light = s.channel * (ptrdiff_t)channels;
    s.view = s.light * (ptrdiff_t)b->lights;
    s.x = s.view * (ptrdiff_t)b->views;
    s.y = s.x * (ptrdiff_t)b->width;
  } else {
    s.x = s.channel * (ptrdiff_t)channels;
    s.y = s.x * (ptrdiff_t)b->width;
    s.light = s.y * (ptrdiff_t)b->height;
    s.view = s.light * (ptrdiff_t)b->lights;
  }
  return s;
}
