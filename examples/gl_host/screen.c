/* SPDX-License-Identifier: MIT */
#include "screen.h"

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <GLES3/gl3.h>
#include <png.h>

#ifdef EXAMPLE_WINDOW
#include <GLFW/glfw3.h>

static GLFWwindow *window;

const char *screen_open_window(void) {
  if (!glfwInit()) return "GLFW finds no screen";
  glfwWindowHint(GLFW_CLIENT_API, GLFW_OPENGL_ES_API);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
  glfwWindowHint(GLFW_CONTEXT_CREATION_API, GLFW_EGL_CONTEXT_API);
  glfwWindowHint(GLFW_RESIZABLE, GLFW_FALSE);
  window = glfwCreateWindow(SCREEN_SIDE, SCREEN_SIDE, "libbtf", NULL, NULL);
  if (window == NULL) return "GLFW has no window with OpenGL ES 3";
  glfwMakeContextCurrent(window);
  return NULL;
}

int screen_show(float *right, float *up) {
  double x, y;
  glfwSwapBuffers(window);
  glfwWaitEvents();
  glfwGetCursorPos(window, &x, &y);
  *right = (float)(2 * x / SCREEN_SIDE - 1);
  *up = (float)(1 - 2 * y / SCREEN_SIDE);
  return !glfwWindowShouldClose(window);
}

#else

const char *screen_open_window(void) {
  return "this program was built without GLFW: name a picture to write";
}

int screen_show(float *right, float *up) {
  *right = *up = 0;
  return 0;
}

#endif

static EGLDisplay display = EGL_NO_DISPLAY;

const char *screen_open_picture(void) {
  static const EGLint version[] = {EGL_CONTEXT_MAJOR_VERSION, 3, EGL_NONE};
  GLuint pixels, frame;
  display = eglGetPlatformDisplay(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL);
  if (!eglInitialize(display, NULL, NULL) ||
      !eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE,
                      eglCreateContext(display, EGL_NO_CONFIG_KHR, EGL_NO_CONTEXT, version)))
    return "EGL has no OpenGL ES 3 without a window";
  glGenRenderbuffers(1, &pixels);
  glBindRenderbuffer(GL_RENDERBUFFER, pixels);
  glRenderbufferStorage(GL_RENDERBUFFER, GL_RGBA8, SCREEN_SIDE, SCREEN_SIDE);
  glGenFramebuffers(1, &frame);
  glBindFramebuffer(GL_FRAMEBUFFER, frame);
  glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER, pixels);
  glViewport(0, 0, SCREEN_SIDE, SCREEN_SIDE);
  return NULL;
}

const char *screen_save_picture(const char *png_path) {
  static unsigned char pixels[SCREEN_SIDE * SCREEN_SIDE * 4];
  static png_image png = {.version = PNG_IMAGE_VERSION, .format = PNG_FORMAT_RGBA};
  png.width = png.height = SCREEN_SIDE;
  glReadPixels(0, 0, SCREEN_SIDE, SCREEN_SIDE, GL_RGBA, GL_UNSIGNED_BYTE, pixels);
  /* GL's first row is the lowest, hence the sign. */
  return png_image_write_to_file(&png, png_path, 0, pixels, -SCREEN_SIDE * 4, NULL) ? NULL : png.message;
}

void screen_close(void) {
#ifdef EXAMPLE_WINDOW
  glfwTerminate();
#endif
  if (display != EGL_NO_DISPLAY) eglTerminate(display);
}
