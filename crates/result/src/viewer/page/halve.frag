#version 300 es
// Means of 2 x 2 pixels; what lies outside is open.
precision highp float;
precision highp sampler2D;
uniform sampler2D light;
out vec4 mean;

void main() {
  ivec2 size = textureSize(light, 0), first = 2 * ivec2(gl_FragCoord.xy);
  vec4 sum = vec4(0.0);
  for (int i = 0; i < 4; i++) {
    ivec2 at = first + ivec2(i & 1, i >> 1);
    if (at.x < size.x && at.y < size.y) sum += texelFetch(light, at, 0);
  }
  mean = 0.25 * sum;
}
