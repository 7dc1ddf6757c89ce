// Fog as the scene has it: one sees so far ahead, so far aside and so far behind, and in between as far as the ellipse
// through these. What is farther has the fog's own colour, and nothing else.

import * as THREE from "three";

/** Without fog, the horizon's haze. */
const CLEAR_M = [420, 420, 420];

export class Fog {
  constructor(visible) {
    this.isClear = !visible;
    this.colour = new THREE.Color(this.isClear ? 0xb9cbd9 : 0xa9b1b8);
    const [ahead, aside, behind] = visible ?? CLEAR_M;
    this.uniforms = {
      fogReach: { value: new THREE.Vector3(ahead, aside, behind) },
      fogFrom: { value: new THREE.Vector2() },
      fogAhead: { value: new THREE.Vector2(1, 0) },
      fogTint: { value: this.colour },
      fogStart: { value: this.isClear ? 0.35 : 0.12 },
    };
  }

  /** The driver's place and heading, in the drawing's coordinates. */
  follow(x, z, heading) {
    this.uniforms.fogFrom.value.set(x, z);
    this.uniforms.fogAhead.value.set(Math.cos(heading), -Math.sin(heading));
  }

  /** Has a material disappear in the fog. */
  cover(material) {
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, this.uniforms);
      shader.vertexShader = shader.vertexShader
        .replace("#include <common>", "#include <common>\nvarying vec3 fogPlace;")
        .replace(
          "#include <project_vertex>",
          `#include <project_vertex>
          vec4 fogWorld = vec4(transformed, 1.0);
          #ifdef USE_INSTANCING
            fogWorld = instanceMatrix * fogWorld;
          #endif
          fogPlace = (modelMatrix * fogWorld).xyz;`,
        );
      shader.fragmentShader = shader.fragmentShader
        .replace(
          "#include <common>",
          `#include <common>
          varying vec3 fogPlace;
          uniform vec3 fogReach;
          uniform vec2 fogFrom;
          uniform vec2 fogAhead;
          uniform vec3 fogTint;
          uniform float fogStart;`,
        )
        .replace(
          "#include <opaque_fragment>",
          `#include <opaque_fragment>
          vec2 fogWay = fogPlace.xz - fogFrom;
          float fogFar = length(fogWay);
          float fogCos = dot(fogWay, fogAhead) / max(fogFar, 1e-3);
          float fogEnd = fogCos > 0.0 ? fogReach.x : fogReach.z;
          float fogSquare = fogCos * fogCos / (fogEnd * fogEnd)
            + (1.0 - fogCos * fogCos) / (fogReach.y * fogReach.y);
          float fogShare = smoothstep(fogStart, 1.0, fogFar * sqrt(fogSquare));
          gl_FragColor.rgb = mix(gl_FragColor.rgb, fogTint, fogShare);`,
        );
    };
    material.customProgramCacheKey = () => "fog";
    return material;
  }
}
