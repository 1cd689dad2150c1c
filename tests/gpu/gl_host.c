/* SPDX-License-Identifier: MIT */
#include "gl_host.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <GL/glcorearb.h>

#include "base/base.h"
#include "ktx2_read.h"

#define GL_FUNCTIONS(X)                                                                                      \
  X(PFNGLGETSTRINGPROC, GetString)                                                                           \
  X(PFNGLGETERRORPROC, GetError)                                                                             \
  X(PFNGLCOMPRESSEDTEXIMAGE2DPROC, CompressedTexImage2D)                                                     \
  X(PFNGLCOMPRESSEDTEXIMAGE3DPROC, CompressedTexImage3D)                                                     \
  X(PFNGLENABLEPROC, Enable)                                                                                 \
  X(PFNGLCREATESHADERPROC, CreateShader)                                                                     \
  X(PFNGLSHADERSOURCEPROC, ShaderSource) X(PFNGLCOMPILESHADERPROC, CompileShader)                            \
      X(PFNGLGETSHADERIVPROC, GetShaderiv) X(PFNGLGETSHADERINFOLOGPROC,                                      \
                                             GetShaderInfoLog) X(PFNGLCREATEPROGRAMPROC, CreateProgram)      \
          X(PFNGLATTACHSHADERPROC, AttachShader) X(PFNGLLINKPROGRAMPROC, LinkProgram) X(                     \
              PFNGLGETPROGRAMIVPROC, GetProgramiv) X(PFNGLGETPROGRAMINFOLOGPROC, GetProgramInfoLog)          \
              X(PFNGLDELETESHADERPROC, DeleteShader) X(PFNGLDELETEPROGRAMPROC, DeleteProgram) X(             \
                  PFNGLUSEPROGRAMPROC, UseProgram) X(PFNGLGETUNIFORMLOCATIONPROC, GetUniformLocation)        \
                  X(PFNGLUNIFORM1IPROC, Uniform1i) X(PFNGLGETUNIFORMBLOCKINDEXPROC, GetUniformBlockIndex) X( \
                      PFNGLUNIFORMBLOCKBINDINGPROC, UniformBlockBinding) X(PFNGLGENBUFFERSPROC, GenBuffers)  \
                      X(PFNGLDELETEBUFFERSPROC, DeleteBuffers) X(PFNGLBINDBUFFERPROC, BindBuffer) X(         \
                          PFNGLBINDBUFFERBASEPROC, BindBufferBase) X(PFNGLBUFFERDATAPROC, BufferData)        \
                          X(PFNGLGENTEXTURESPROC, GenTextures) X(PFNGLDELETETEXTURESPROC, DeleteTextures) X( \
                              PFNGLACTIVETEXTUREPROC, ActiveTexture) X(PFNGLBINDTEXTUREPROC, BindTexture)    \
                              X(PFNGLTEXPARAMETERIPROC, TexParameteri) X(PFNGLPIXELSTOREIPROC, PixelStorei)  \
                                  X(PFNGLTEXIMAGE2DPROC, TexImage2D) X(PFNGLTEXIMAGE3DPROC, TexImage3D)      \
                                      X(PFNGLGENFRAMEBUFFERSPROC,                                            \
                                        GenFramebuffers) X(PFNGLDELETEFRAMEBUFFERSPROC, DeleteFramebuffers)  \
                                          X(PFNGLBINDFRAMEBUFFERPROC, BindFramebuffer)                       \
                                              X(PFNGLFRAMEBUFFERTEXTURE2DPROC, FramebufferTexture2D)         \
                                                  X(PFNGLCHECKFRAMEBUFFERSTATUSPROC, CheckFramebufferStatus) \
                                                      X(PFNGLGENVERTEXARRAYSPROC, GenVertexArrays)           \
                                                          X(PFNGLBINDVERTEXARRAYPROC, BindVertexArray)       \
                                                              X(PFNGLVIEWPORTPROC, Viewport)                 \
                                                                  X(PFNGLDRAWARRAYSPROC, DrawArrays)         \
                                                                      X(PFNGLREADPIXELSPROC, ReadPixels)

enum { MOST_TEXTURES = 32, SIDE = 256 /* of the picture that queries are drawn in */ };

struct gl_host {
  btf_context *ctx; /* for the JSON parser */
  gl_dialect dialect;
  EGLDisplay display;
  EGLContext context;
  GLuint program, textures[MOST_TEXTURES], texture_count, block, queries[3], target, frame, vertices;
  char message[4096];
#define DECLARE(type, name) type name;
  GL_FUNCTIONS(DECLARE)
#undef DECLARE
};

static const char *const names[GL_DIALECTS] = {"GLSL ES 3.00", "GLSL 3.30", "GLSL 4.50"};

const char *gl_dialect_name(gl_dialect dialect) {
  return names[dialect];
}

/* ---- context ---- */

static bool make_context(gl_host *h, const char **why) {
  const PFNEGLGETPLATFORMDISPLAYEXTPROC get_display =
      (PFNEGLGETPLATFORMDISPLAYEXTPROC)eglGetProcAddress("eglGetPlatformDisplayEXT");
  const EGLint es[] = {EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 0, EGL_NONE};
  const EGLint core33[] = {EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 3, EGL_NONE};
  const EGLint core45[] = {EGL_CONTEXT_MAJOR_VERSION, 4, EGL_CONTEXT_MINOR_VERSION, 5, EGL_NONE};
  const EGLint *const attributes[GL_DIALECTS] = {es, core33, core45};
  *why = "EGL has no display without a window";
  if (get_display == NULL) return false;
  h->display = get_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL);
  if (h->display == EGL_NO_DISPLAY || !eglInitialize(h->display, NULL, NULL)) return false;
  *why = "EGL makes no context of this version";
  if (!eglBindAPI(h->dialect == GL_ES_300 ? EGL_OPENGL_ES_API : EGL_OPENGL_API)) return false;
  h->context = eglCreateContext(h->display, EGL_NO_CONFIG_KHR, EGL_NO_CONTEXT, attributes[h->dialect]);
  if (h->context == EGL_NO_CONTEXT) return false;
  return eglMakeCurrent(h->display, EGL_NO_SURFACE, EGL_NO_SURFACE, h->context);
}

static bool get_functions(gl_host *h) {
  bool all = true;
#define GET(type, name)                                                                                      \
  h->name = (type)eglGetProcAddress("gl" #name);                                                             \
  all = all && h->name != NULL;
  GL_FUNCTIONS(GET)
#undef GET
  return all;
}

/* A picture of floats, without filter. */
static void make_picture(gl_host *h, GLuint texture) {
  h->BindTexture(GL_TEXTURE_2D, texture);
  h->TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  h->TexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  h->TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32F, SIDE, SIDE, 0, GL_RGBA, GL_FLOAT, NULL);
}

gl_host *gl_host_open(gl_dialect dialect, const char **why) {
  gl_host *h = calloc(1, sizeof *h);
  *why = "no memory";
  if (h == NULL) return NULL;
  h->dialect = dialect;
  if (btf_context_create(NULL, &h->ctx) != BTF_OK || !make_context(h, why) || !get_functions(h)) {
    gl_host_close(h);
    return NULL;
  }
  h->GenTextures(3, h->queries);
  h->GenTextures(1, &h->target);
  for (int i = 0; i < 3; i++) make_picture(h, h->queries[i]);
  make_picture(h, h->target);
  h->GenFramebuffers(1, &h->frame);
  h->BindFramebuffer(GL_FRAMEBUFFER, h->frame);
  h->FramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, h->target, 0);
  h->GenVertexArrays(1, &h->vertices);
  h->BindVertexArray(h->vertices);
  h->PixelStorei(GL_UNPACK_ALIGNMENT, 1);
  *why = "a picture of floats cannot be drawn to";
  if (h->CheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
    gl_host_close(h);
    return NULL;
  }
  *why = NULL;
  return h;
}

const char *gl_host_renderer(const gl_host *h) {
  return (const char *)h->GetString(GL_RENDERER);
}

static void unload(gl_host *h) {
  if (h->program != 0) h->DeleteProgram(h->program);
  if (h->texture_count > 0) h->DeleteTextures((GLsizei)h->texture_count, h->textures);
  if (h->block != 0) h->DeleteBuffers(1, &h->block);
  h->program = h->texture_count = h->block = 0;
}

void gl_host_close(gl_host *h) {
  if (h == NULL) return;
  if (h->frame != 0) unload(h);
  if (h->display != EGL_NO_DISPLAY) {
    eglMakeCurrent(h->display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    if (h->context != EGL_NO_CONTEXT) eglDestroyContext(h->display, h->context);
    eglTerminate(h->display);
  }
  btf_context_release(h->ctx);
  free(h);
}

/* ---- the export ---- */

static char *read_text(const char *folder, const char *name, size_t *size) {
  char path[1024];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  FILE *file = fopen(path, "rb");
  if (file == NULL) return NULL;
  fseek(file, 0, SEEK_END);
  const long length = ftell(file);
  rewind(file);
  char *text = length >= 0 ? malloc((size_t)length + 1) : NULL;
  if (text != NULL) {
    *size = fread(text, 1, (size_t)length, file);
    text[*size] = '\0';
  }
  fclose(file);
  return text;
}

typedef struct upload_format {
  uint32_t vk;
  GLint internal;
  GLenum format, type; /* 0 = blocks */
} upload_format;

static const upload_format *upload_format_of(uint32_t vk) {
  static const upload_format formats[] = {
      {9, GL_R8, GL_RED, GL_UNSIGNED_BYTE},
      {16, GL_RG8, GL_RG, GL_UNSIGNED_BYTE},
      {37, GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE},
      {38, GL_RGBA8_SNORM, GL_RGBA, GL_BYTE},
      {76, GL_R16F, GL_RED, GL_HALF_FLOAT},
      {83, GL_RG16F, GL_RG, GL_HALF_FLOAT},
      {97, GL_RGBA16F, GL_RGBA, GL_HALF_FLOAT},
      {100, GL_R32F, GL_RED, GL_FLOAT},
      {103, GL_RG32F, GL_RG, GL_FLOAT},
      {109, GL_RGBA32F, GL_RGBA, GL_FLOAT},
      {143, GL_COMPRESSED_RGB_BPTC_UNSIGNED_FLOAT, 0, 0},
      {144, GL_COMPRESSED_RGB_BPTC_SIGNED_FLOAT, 0, 0},
      {145, GL_COMPRESSED_RGBA_BPTC_UNORM, 0, 0},
  };
  for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
    if (formats[i].vk == vk) return &formats[i];
  return NULL;
}

static uint32_t whole(const btfi_json *object, const char *key) {
  return (uint32_t)btfi_json_number(btfi_json_get(object, key));
}

static bool is_word(const btfi_json *object, const char *key, const char *word) {
  const char *text = btfi_json_string(btfi_json_get(object, key));
  return text != NULL && strcmp(text, word) == 0;
}

static GLint wrap_of(const btfi_json *entry, uint64_t axis) {
  const char *word = btfi_json_string(btfi_json_at(btfi_json_get(entry, "wrap"), axis));
  return word != NULL && strcmp(word, "repeat") == 0 ? GL_REPEAT : GL_CLAMP_TO_EDGE;
}

static const char *put_texture(gl_host *h, const btfi_json *entry, const ktx2_texture *t) {
  const upload_format *f = upload_format_of(t->vk_format);
  const bool is_3d = is_word(entry, "dimension", "3d"), is_array = is_word(entry, "dimension", "2d_array");
  const GLenum at = is_3d ? GL_TEXTURE_3D : is_array ? GL_TEXTURE_2D_ARRAY : GL_TEXTURE_2D;
  const bool filtered = is_word(entry, "min_filter", "linear");
  const uint32_t slices = is_3d ? whole(entry, "depth") : whole(entry, "layers");
  if (t->vk_format != whole(entry, "vk_format") || t->width != whole(entry, "width") ||
      t->height != whole(entry, "height") || t->levels != whole(entry, "levels") ||
      t->depth != (is_3d ? slices : 0) || t->layers != (is_array ? slices : 0))
    return "manifest and texture disagree";
  h->BindTexture(at, h->textures[h->texture_count]);
  h->TexParameteri(at, GL_TEXTURE_WRAP_S, wrap_of(entry, 0));
  h->TexParameteri(at, GL_TEXTURE_WRAP_T, wrap_of(entry, 1));
  h->TexParameteri(at, GL_TEXTURE_WRAP_R, GL_CLAMP_TO_EDGE);
  h->TexParameteri(at, GL_TEXTURE_MAX_LEVEL, (GLint)t->levels - 1);
  h->TexParameteri(at, GL_TEXTURE_MAG_FILTER, filtered ? GL_LINEAR : GL_NEAREST);
  h->TexParameteri(at, GL_TEXTURE_MIN_FILTER, filtered ? GL_LINEAR_MIPMAP_LINEAR : GL_NEAREST_MIPMAP_NEAREST);
  for (uint32_t l = 0; l < t->levels; l++) {
    const GLsizei w = (GLsizei)(t->width >> l ? t->width >> l : 1),
                  v = (GLsizei)(t->height >> l ? t->height >> l : 1);
    const GLsizei bytes = (GLsizei)t->level_size[l];
    if (f->format == 0 && at == GL_TEXTURE_2D)
      h->CompressedTexImage2D(at, (GLint)l, (GLenum)f->internal, w, v, 0, bytes, t->level[l]);
    else if (f->format == 0)
      h->CompressedTexImage3D(at, (GLint)l, (GLenum)f->internal, w, v, (GLsizei)slices, 0, bytes,
                              t->level[l]);
    else if (at == GL_TEXTURE_2D)
      h->TexImage2D(at, (GLint)l, f->internal, w, v, 0, f->format, f->type, t->level[l]);
    else
      h->TexImage3D(at, (GLint)l, f->internal, w, v, (GLsizei)slices, 0, f->format, f->type, t->level[l]);
  }
  return h->GetError() == GL_NO_ERROR ? NULL : "GL refuses a texture";
}

static const char *load_texture(gl_host *h, const char *folder, const btfi_json *entry) {
  const char *file = btfi_json_string(btfi_json_get(entry, "file")), *wrong;
  ktx2_texture texture;
  size_t size = 0;
  if (file == NULL || h->texture_count == MOST_TEXTURES) return "an entry without file, or too many";
  char *bytes = read_text(folder, file, &size);
  if (bytes == NULL) return "a texture cannot be read";
  wrong = ktx2_read((const unsigned char *)bytes, size, &texture);
  if (wrong == NULL) {
    h->GenTextures(1, &h->textures[h->texture_count]);
    wrong = put_texture(h, entry, &texture);
    h->texture_count++;
  }
  ktx2_free(&texture);
  free(bytes);
  return wrong;
}

/* The block from the values of the manifest, by their offsets: arrays have 16 bytes an element. */
static void load_block(gl_host *h, const btfi_json *manifest) {
  unsigned char block[16384] = {0};
  const uint32_t size = whole(btfi_json_get(manifest, "uniform_block"), "size");
  const btfi_json *fields = btfi_json_get(manifest, "uniforms");
  for (uint64_t i = 0; i < btfi_json_length(fields); i++) {
    const btfi_json *field = btfi_json_at(fields, i), *values = btfi_json_get(field, "value");
    const uint64_t count = whole(field, "count"), components = btfi_json_length(values) / (count ? count : 1);
    const bool integer = is_word(field, "type", "int") || is_word(field, "type", "ivec4");
    for (uint64_t k = 0; k < btfi_json_length(values); k++) {
      const uint64_t at = whole(field, "offset") + k / components * 16 + k % components * 4;
      const double value = btfi_json_number(btfi_json_at(values, k));
      const float real = (float)value;
      const int32_t number = (int32_t)value;
      if (at + 4 <= sizeof block)
        memcpy(block + at, integer ? (const void *)&number : (const void *)&real, 4);
    }
  }
  h->GenBuffers(1, &h->block);
  h->BindBuffer(GL_UNIFORM_BUFFER, h->block);
  h->BufferData(GL_UNIFORM_BUFFER, (GLsizeiptr)size, block, GL_STATIC_DRAW);
}

static GLuint compile(gl_host *h, GLenum kind, const char *body, const char *tail) {
  static const char *const versions[GL_DIALECTS] = {"#version 300 es\nprecision highp float;\n",
                                                    "#version 330 core\n", "#version 450 core\n"};
  const char *const parts[] = {versions[h->dialect], body, tail};
  const GLuint shader = h->CreateShader(kind);
  GLint compiled = 0;
  h->ShaderSource(shader, 3, parts, NULL);
  h->CompileShader(shader);
  h->GetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
  if (compiled) return shader;
  h->GetShaderInfoLog(shader, sizeof h->message, NULL, h->message);
  h->DeleteShader(shader);
  return 0;
}

static const char vertex_shader[] =
    "void main() {\n"
    "  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);\n"
    "}\n";
static const char fragment_tail[] =
    "uniform highp sampler2D query0, query1, query2;\n"
    "layout(location = 0) out vec4 result;\n"
    "void main() {\n"
    "  ivec2 at = ivec2(gl_FragCoord.xy);\n"
    "  vec4 a = texelFetch(query0, at, 0), b = texelFetch(query1, at, 0), c = texelFetch(query2, at, 0);\n"
    "  result = vec4(btf_eval(a.xyz, vec3(a.w, b.xy), b.zw, c.x), 1.0);\n"
    "}\n";

static const char *make_program(gl_host *h, const char *glsl) {
  const GLuint vertex = compile(h, GL_VERTEX_SHADER, "", vertex_shader);
  const GLuint fragment = vertex != 0 ? compile(h, GL_FRAGMENT_SHADER, glsl, fragment_tail) : 0;
  GLint linked = 0;
  if (fragment == 0) return h->message;
  h->program = h->CreateProgram();
  h->AttachShader(h->program, vertex);
  h->AttachShader(h->program, fragment);
  h->LinkProgram(h->program);
  h->DeleteShader(vertex);
  h->DeleteShader(fragment);
  h->GetProgramiv(h->program, GL_LINK_STATUS, &linked);
  if (linked) return NULL;
  h->GetProgramInfoLog(h->program, sizeof h->message, NULL, h->message);
  return h->message;
}

static void bind(gl_host *h, const char *name, GLuint unit, GLenum target, GLuint texture) {
  h->ActiveTexture(GL_TEXTURE0 + unit);
  h->BindTexture(target, texture);
  h->Uniform1i(h->GetUniformLocation(h->program, name), (GLint)unit);
}

static void bind_all(gl_host *h, const btfi_json *textures) {
  static const char *const names_of_queries[] = {"query0", "query1", "query2"};
  h->UseProgram(h->program);
  for (GLuint i = 0; i < h->texture_count; i++) {
    const btfi_json *entry = btfi_json_at(textures, i);
    const GLenum target = is_word(entry, "dimension", "3d")         ? GL_TEXTURE_3D
                          : is_word(entry, "dimension", "2d_array") ? GL_TEXTURE_2D_ARRAY
                                                                    : GL_TEXTURE_2D;
    bind(h, btfi_json_string(btfi_json_get(entry, "name")), i + 3, target, h->textures[i]);
  }
  for (GLuint i = 0; i < 3; i++) bind(h, names_of_queries[i], i, GL_TEXTURE_2D, h->queries[i]);
  const GLuint block = h->GetUniformBlockIndex(h->program, "btf_uniforms");
  if (block != GL_INVALID_INDEX) h->UniformBlockBinding(h->program, block, 0);
  h->BindBufferBase(GL_UNIFORM_BUFFER, 0, h->block);
}

const char *gl_host_load(gl_host *h, const char *folder, char *(*edit)(char *glsl)) {
  size_t size = 0;
  btfi_json *manifest = NULL;
  const char *wrong = "no manifest";
  char *text = read_text(folder, "manifest.json", &size), *glsl = read_text(folder, "btf.glsl", &size);
  unload(h);
  h->ActiveTexture(GL_TEXTURE0);
  if (glsl != NULL && edit != NULL) glsl = edit(glsl);
  if (text != NULL && glsl != NULL &&
      btfi_json_parse(h->ctx, folder, text, strlen(text), &manifest) == BTF_OK &&
      is_word(manifest, "format", "btf-gpu") && whole(manifest, "version") == 1) {
    const btfi_json *textures = btfi_json_get(manifest, "textures");
    wrong = NULL;
    for (uint64_t i = 0; wrong == NULL && i < btfi_json_length(textures); i++)
      wrong = load_texture(h, folder, btfi_json_at(textures, i));
    if (wrong == NULL) wrong = make_program(h, glsl);
    if (wrong == NULL) {
      load_block(h, manifest);
      bind_all(h, textures);
      if (h->GetError() != GL_NO_ERROR) wrong = "GL refuses the export";
    }
  }
  btfi_json_free(manifest);
  free(text);
  free(glsl);
  return wrong;
}

/* ---- queries ---- */

static void put_queries(gl_host *h, const float *queries, size_t count) {
  static float pictures[3][SIDE * SIDE][4];
  memset(pictures, 0, sizeof pictures);
  for (size_t i = 0; i < count; i++)
    for (size_t k = 0; k < 9; k++) pictures[k / 4][i][k % 4] = queries[9 * i + k];
  for (GLuint p = 0; p < 3; p++) {
    h->ActiveTexture(GL_TEXTURE0 + p);
    h->BindTexture(GL_TEXTURE_2D, h->queries[p]);
    h->TexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32F, SIDE, SIDE, 0, GL_RGBA, GL_FLOAT, pictures[p]);
  }
}

const char *gl_host_eval(gl_host *h, const float *queries, size_t count, float *out) {
  static float picture[SIDE * SIDE][4];
  while (count > 0) {
    const size_t n = count < SIDE * SIDE ? count : SIDE * SIDE;
    put_queries(h, queries, n);
    h->Viewport(0, 0, SIDE, SIDE);
    h->DrawArrays(GL_TRIANGLES, 0, 3);
    h->ReadPixels(0, 0, SIDE, SIDE, GL_RGBA, GL_FLOAT, picture);
    if (h->GetError() != GL_NO_ERROR) return "GL cannot draw the queries";
    for (size_t i = 0; i < n; i++) memcpy(out + 3 * i, picture[i], 3 * sizeof(float));
    queries += 9 * n;
    out += 3 * n;
    count -= n;
  }
  return NULL;
}
