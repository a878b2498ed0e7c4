"""The optimum of OpenCV's stereo cost on the reference corners, to rounding.

    pip install opencv-python-headless==5.0.0.* numpy
    python opencv_optimum.py .../stereo/opencv_reference.json > opencv_optimum.json

`opencv_tight`: cv2.stereoCalibrate itself, criteria 10 000 iterations and 1e-18, from cv2.calibrateCamera. It
stops near the optimum, not at it, at a place that depends on the start: started again from its own result,
or from parameters 1e-3 away, it ends between -0.04161 and -0.04167 in the left k3.
`optimum`: from there Gauss-Newton on OpenCV's own residuals and derivatives (cv2.projectPoints,
cv2.composeRT) in double precision until only rounding is left (1e-11 of each parameter).
`optimum_rounded_board`: the same with the board's corners rounded to single precision, which OpenCV's
interface asks for: 3e-8 of the board, up to 2e-4 of a weakly determined parameter (p2 of the right lens).
"""
import json, sys, numpy as np, cv2
d=json.load(open(sys.argv[1]))
obj=np.zeros((54,3)); obj[:,:2]=np.mgrid[0:9,0:6].T.reshape(-1,2)*0.025
C=[[np.array(d['corners_px'][f'{s}{k:02d}.jpg'],np.float32) for k in range(1,10)] for s in ('left','right')]
O=[obj.astype(np.float32).reshape(-1,1,3)]*9; size=(640,480)
rounded=obj.astype(np.float32).astype(np.float64)
crit=(cv2.TERM_CRITERIA_COUNT+cv2.TERM_CRITERIA_EPS,10000,1e-18)
mono=[cv2.calibrateCamera(O,[c.reshape(-1,1,2) for c in cs],size,None,None,criteria=crit) for cs in C]
r=cv2.stereoCalibrate(O,*[[c.reshape(-1,1,2) for c in cs] for cs in C],mono[0][1].copy(),mono[0][2].copy(),mono[1][1].copy(),mono[1][2].copy(),size,flags=cv2.CALIB_USE_INTRINSIC_GUESS,criteria=crit)
pack=lambda K,D: np.r_[K[0,0],K[1,1],K[0,2],K[1,2],D.ravel()[:5]]
# parameters: 9 left, 9 right, om(3), T(3), then per view rvec, tvec
x=np.r_[pack(r[1],r[2]),pack(r[3],r[4]),cv2.Rodrigues(r[5])[0].ravel(),r[6].ravel(),*[np.r_[mono[0][3][k].ravel(),mono[0][4][k].ravel()] for k in range(9)]].astype(float)
def project(obj,p,rv,tv):
    K=np.array([[p[0],0,p[2]],[0,p[1],p[3]],[0,0,1]])
    q,J=cv2.projectPoints(obj.reshape(-1,1,3),rv,tv,K,p[4:9])
    return q.reshape(-1,2),J   # J: rvec3 tvec3 f2 c2 k5
def system(obj,x):
    E=[];Js=[]
    for k in range(9):
        b=24+6*k; rv,tv=x[b:b+3].copy(),x[b+3:b+6].copy()
        q,J=project(obj,x[0:9],rv,tv); A=np.zeros((108,x.size))
        A[:,0:9]=J[:,6:15]; A[:,b:b+6]=J[:,0:6]; E.append((q-C[0][k]).ravel()); Js.append(A)
        r3,t3,dr3r1,dr3t1,dr3r2,dr3t2,dt3r1,dt3t1,dt3r2,dt3t2=cv2.composeRT(rv,tv,x[18:21].copy(),x[21:24].copy())
        q,J=project(obj,x[9:18],r3,t3); A=np.zeros((108,x.size)); Jr,Jt=J[:,0:3],J[:,3:6]
        A[:,9:18]=J[:,6:15]
        A[:,b:b+3]=Jr@dr3r1+Jt@dt3r1; A[:,b+3:b+6]=Jr@dr3t1+Jt@dt3t1
        A[:,18:21]=Jr@dr3r2+Jt@dt3r2; A[:,21:24]=Jr@dr3t2+Jt@dt3t2
        E.append((q-C[1][k]).ravel()); Js.append(A)
    return np.concatenate(E),np.vstack(Js)
def optimum(obj,x):
    for it in range(20):
        e,J=system(obj,x); s=np.linalg.norm(J,axis=0); dx=np.linalg.lstsq(J/s,-e,rcond=None)[0]/s
        x=x+dx; print(it,np.abs(dx/np.where(x==0,1,x)).max(),file=sys.stderr)
    e,_=system(obj,x)
    return result(np.sqrt((e**2).sum()*2/e.size),K(x[:9]),x[4:9],K(x[9:18]),x[13:18],cv2.Rodrigues(x[18:21])[0],x[21:24])
def K(p): return np.array([[p[0],0,p[2]],[0,p[1],p[3]],[0,0,1]])
def result(rms,K1,D1,K2,D2,R,T):
    return dict(joint_rms_px=float(rms),K1=K1.tolist(),D1=D1.ravel()[:5].tolist(),K2=K2.tolist(),D2=D2.ravel()[:5].tolist(),
        R_right_from_left=R.tolist(),T_right_from_left_mm=(T*1e3).ravel().tolist())
json.dump(dict(opencv=cv2.__version__,opencv_tight=result(*r[:7]),optimum=optimum(obj,x),optimum_rounded_board=optimum(rounded,x)),sys.stdout,indent=1)
print()
