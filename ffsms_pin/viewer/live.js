// The live page: Meshcat's viewer, connected to the socket beside this page.
var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
const socket = new URL("socket", location.href);
socket.protocol = "ws:";
viewer.connect(socket.href);
