// The arm, drawn from capsules and boxes in its links' frames. Where the links are, the console says with every state.

import * as THREE from "three";

// Per drawn link (base, links 1 to 7, hand): capsules [from, to, radius], metres, in the link's own frame.
const SHELL = [
  [[[-0.06, 0, 0.03], [0.02, 0, 0.03], 0.07], [[0, 0, 0.03], [0, 0, 0.12], 0.066]],
  [[[0, 0, -0.19], [0, 0, 0], 0.058], [[0, -0.075, 0], [0, 0, 0], 0.057]],
  [[[0, 0, 0], [0, 0, 0.075], 0.057], [[0, -0.17, 0], [0, 0, 0], 0.056]],
  [[[0, 0, -0.13], [0, 0, -0.06], 0.055], [[0, 0, -0.06], [0.0825, 0.02, 0], 0.05], [[0.0825, 0, 0], [0.0825, 0.07, 0], 0.053]],
  [[[-0.0825, 0.03, 0], [-0.0825, 0.1, 0], 0.053], [[-0.0825, 0.06, 0], [0, 0, 0.02], 0.05], [[0, 0, 0], [0, 0, 0.065], 0.052]],
  [[[0, 0, -0.25], [0, 0, -0.2], 0.055], [[0, 0.02, -0.2], [0, 0.075, -0.05], 0.042], [[0, 0, 0], [0, 0.075, 0], 0.053]],
  [[[0, 0, 0], [0.088, 0, 0], 0.047], [[0.088, -0.02, 0], [0.088, 0.04, 0], 0.048]],
  [[[0, 0, 0.03], [0, 0, 0.085], 0.043]],
  [],
];
// Which of a link's capsules are the dark covers of its joint.
const DARK = { 1: 1, 2: 0, 3: 2, 4: 2, 5: 2, 6: 1 };
const FINGER_FROM_HAND_M = 0.0584;

function capsule([from, to, radius], material) {
  const [a, b] = [new THREE.Vector3(...from), new THREE.Vector3(...to)];
  const along = b.clone().sub(a);
  const mesh = new THREE.Mesh(new THREE.CapsuleGeometry(radius, along.length(), 6, 18), material);
  mesh.position.copy(a).lerp(b, 0.5);
  mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.normalize());
  return mesh;
}

function box(size, at, material) {
  const mesh = new THREE.Mesh(new THREE.BoxGeometry(...size), material);
  mesh.position.set(...at);
  return mesh;
}

export class Arm {
  /** `ghost`: see-through, for a planned pose. */
  constructor({ ghost = false } = {}) {
    const look = ghost
      ? { transparent: true, opacity: 0.34, depthWrite: false, roughness: 0.9, color: 0x4d8df5 }
      : { roughness: 0.55, metalness: 0.05, color: 0xe9edf2 };
    const shell = new THREE.MeshStandardMaterial(look);
    const dark = ghost ? shell : new THREE.MeshStandardMaterial({ roughness: 0.6, metalness: 0.1, color: 0x39424e });
    this.group = new THREE.Group();
    this.group.visible = false;
    this.links = SHELL.map((capsules, k) => {
      const link = new THREE.Group();
      link.matrixAutoUpdate = false;
      capsules.forEach((shape, i) => link.add(capsule(shape, DARK[k] === i ? dark : shell)));
      this.group.add(link);
      return link;
    });
    const hand = this.links[8];
    hand.add(box([0.05, 0.204, 0.05], [0, 0, 0.03], shell), box([0.042, 0.19, 0.014], [0, 0, 0.058], dark));
    this.fingers = [1, -1].map((side) => {
      const finger = new THREE.Group();
      finger.add(box([0.02, 0.012, 0.036], [0, side * 0.011, 0.018], dark), box([0.018, 0.008, 0.022], [0, side * 0.006, 0.043], shell));
      hand.add(finger);
      return finger;
    });
    this.setOpening(0.08);
  }

  /** Puts each link where its 12 numbers (row-major, no last row) say. */
  setLinks(poses) {
    poses.forEach((pose, k) => this.links[k].matrix.set(...pose, 0, 0, 0, 1));
    this.group.visible = true;
  }

  /** How far apart the fingertips are, metres. */
  setOpening(width) {
    this.fingers.forEach((finger, k) => finger.position.set(0, (k ? -1 : 1) * width / 2, FINGER_FROM_HAND_M));
  }
}
