/* SPDX-License-Identifier: MIT */
/*
 * A renderer's side of an export, in OpenGL ES 3: uploads a model's textures and numbers, puts its shader
 * before one's own, and draws a lit sphere to a picture; or, if built with GLFW, in a window where the light
 * follows the cursor.
 *
 *     example_gl_host wool.btfz [wool.png]
 */
#include <btf/btf.h>

#include "screen.h"
#include "sphere.h"

#include <GLES3/gl3.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

/* The texture stays bound to its unit. Filters of 32-bit texels need GL_OES_texture_float_linear. */
static const char *upload(const btf_gpu_texture *t, GLuint unit) {
  static const struct {
    uint32_t texel;
    GLint internal;
    GLenum layout, type;
  } formats[] = {
      {BTF_TEXEL_R8_UNORM, GL_R8, GL_RED, GL_UNSIGNED_BYTE},
      {BTF_TEXEL_RG8_UNORM, GL_RG8, GL_RG, GL_UNSIGNED_BYTE},
      {BTF_TEXEL_RGBA8_UNORM, GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE},
      {BTF_TEXEL_RGBA8_SNORM, GL_RGBA8_SNORM, GL_RGBA, GL_BYTE},
      {BTF_TEXEL_R16_FLOAT, GL_R16F, GL_RED, GL_HALF_FLOAT},
      {BTF_TEXEL_RG16_FLOAT, GL_RG16F, GL_RG, GL_HALF_FLOAT},
      {BTF_TEXEL_RGBA16_FLOAT, GL_RGBA16F, GL_RGBA, GL_HALF_FLOAT},
      {BTF_TEXEL_R32_FLOAT, GL_R32F, GL_RED, GL_FLOAT},
      {BTF_TEXEL_RG32_FLOAT, GL_RG32F, GL_RG, GL_FLOAT},
      {BTF_TEXEL_RGBA32_FLOAT, GL_RGBA32F, GL_RGBA, GL_FLOAT},
  };
  static const GLenum axes[] = {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T, GL_TEXTURE_WRAP_R};
  const GLenum target = t->dimension == BTF_TEXTURE_2D   ? GL_TEXTURE_2D
                        : t->dimension == BTF_TEXTURE_3D ? GL_TEXTURE_3D
                                                         : GL_TEXTURE_2D_ARRAY;
  const GLint within = t->mag_filter == BTF_FILTER_LINEAR ? GL_LINEAR : GL_NEAREST;
  const GLint between =
      t->min_filter == BTF_FILTER_LINEAR ? GL_LINEAR_MIPMAP_LINEAR : GL_NEAREST_MIPMAP_NEAREST;
  GLuint name;
  size_t f = 0;
  while (formats[f].texel != t->texel)
    if (++f == sizeof formats / sizeof *formats) return "a texture has texels of an unknown format";
  glGenTextures(1, &name);
  glActiveTexture(GL_TEXTURE0 + unit);
  glBindTexture(target, name);
  glTexParameteri(target, GL_TEXTURE_MAX_LEVEL, (GLint)t->level_count - 1);
  glTexParameteri(target, GL_TEXTURE_MAG_FILTER, within);
  glTexParameteri(target, GL_TEXTURE_MIN_FILTER, between);
  for (int k = 0; k < 3; k++)
    glTexParameteri(target, axes[k], t->wrap[k] == BTF_WRAP_CLAMP ? GL_CLAMP_TO_EDGE : GL_REPEAT);
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1); /* rows have no gaps */
  for (GLint i = 0; i < (GLint)t->level_count; i++) {
    const btf_gpu_level *l = &t->levels[i];
    const GLsizei w = (GLsizei)l->width, h = (GLsizei)l->height, d = (GLsizei)l->depth;
    if (target == GL_TEXTURE_2D)
      glTexImage2D(target, i, formats[f].internal, w, h, 0, formats[f].layout, formats[f].type, l->data);
    else
      glTexImage3D(target, i, formats[f].internal, w, h, d, 0, formats[f].layout, formats[f].type, l->data);
  }
  return NULL;
}

static void add_shader(GLuint program, GLenum kind, const char *model, const char *own) {
  const char *const parts[] = {"#version 300 es\nprecision highp float;\n", model, own};
  const GLuint shader = glCreateShader(kind);
  glShaderSource(shader, 3, parts, NULL);
  glCompileShader(shader);
  glAttachShader(program, shader);
}

/* Afterwards GL has all that it needs of the export. */
static const char *load(const btf_gpu_export *e, GLuint program) {
  const char *wrong = NULL;
  GLuint block;
  GLint linked;
  size_t size;
  const void *numbers = btf_gpu_uniforms(e, &size);
  add_shader(program, GL_VERTEX_SHADER, "", sphere_vertices);
  add_shader(program, GL_FRAGMENT_SHADER, btf_gpu_glsl(e), sphere_fragments);
  glLinkProgram(program);
  glGetProgramiv(program, GL_LINK_STATUS, &linked);
  if (!linked) return "the shader does not compile";
  glUseProgram(program);
  for (uint32_t i = 0; wrong == NULL && i < btf_gpu_texture_count(e); i++) {
    btf_gpu_texture t = BTF_GPU_TEXTURE_INIT;
    btf_gpu_texture_at(e, i, &t);
    wrong = upload(&t, i);
    glUniform1i(glGetUniformLocation(program, t.name), (GLint)i);
  }
  glGenBuffers(1, &block);
  glBindBufferBase(GL_UNIFORM_BUFFER, 0, block);
  glBufferData(GL_UNIFORM_BUFFER, (GLsizeiptr)size, numbers, GL_STATIC_DRAW);
  glUniformBlockBinding(program, glGetUniformBlockIndex(program, "btf_uniforms"), 0);
  return wrong == NULL && glGetError() != GL_NO_ERROR ? "OpenGL refuses the export" : wrong;
}

/* Light from the side of the eye, by how far it is to the right and up. */
static void draw(GLuint program, float right, float up) {
  const float back = sqrtf(fmaxf(1 - right * right - up * up, 0));
  glUniform3f(glGetUniformLocation(program, "light"), right, up, back);
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

/* `file` names what is wrong, or is NULL. */
static int done(const char *file, const char *wrong) {
  if (wrong != NULL) fprintf(stderr, "%s%s%s\n", file != NULL ? file : "", file != NULL ? ": " : "", wrong);
  screen_close();
  return wrong == NULL ? 0 : 2;
}

int main(int argc, char **argv) {
  btf_context *ctx;
  btf_model *model;
  btf_gpu_export *e;
  if (argc < 2 || argc > 3 || argv[1][0] == '-') {
    const int asked = argc == 2 && strcmp(argv[1], "--help") == 0;
    fprintf(asked ? stdout : stderr, "usage: example_gl_host MODEL.btfz [OUT.png]\n");
    return asked ? 0 : 1;
  }
  if (btf_context_create(NULL, &ctx) != BTF_OK || btf_model_load(ctx, argv[1], &model) != BTF_OK)
    return done(NULL, btf_error_message());
  if (btf_gpu_export_create(model, NULL, &e) != BTF_OK) return done(argv[1], btf_error_message());

  float right = -0.41318f, up = 0.55143f;
  const char *wrong = argc == 3 ? screen_open_picture() : screen_open_window();
  if (wrong != NULL) return done(NULL, wrong);
  const GLuint program = glCreateProgram();
  wrong = load(e, program);
  btf_gpu_export_release(e);
  btf_model_release(model);
  btf_context_release(ctx);
  if (wrong != NULL) return done(argv[1], wrong);
  if (argc == 3) {
    draw(program, right, up);
    wrong = screen_save_picture(argv[2]);
    if (wrong == NULL) printf("saved %s\n", argv[2]);
    return done(argv[2], wrong);
  }
  do draw(program, right, up);
  while (screen_show(&right, &up));
  return done(NULL, NULL);
}
